"""From images to the map (Fig. 3 without the choice of views): records in, poses and maps out.

Nodes, bag commands and the simulated robot use the same objects. Synchronizers are cheap: they
pair, wait, and drop with a reason. Estimators, localizer and map builder are heavy: a node runs
them in its worker.
"""
