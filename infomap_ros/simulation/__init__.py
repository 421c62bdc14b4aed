"""Simulated worlds, the rover in them, its stereo camera, and the recorder of bags.

Importing this package chooses how MuJoCo draws (`backend.select_backend`), because MuJoCo reads
that choice from the environment when it is first imported.
"""

from infomap_ros.simulation.backend import select_backend

select_backend()
