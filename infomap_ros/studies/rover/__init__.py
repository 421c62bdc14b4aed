"""The rover's experiment of Figs. 16 to 18 of Sujan and Dubowsky (2005), in the simulator.

doi:10.1177/0278364905051774
"""
