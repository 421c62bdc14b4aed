"""Published ways to choose views, written from their papers, as strategies for planar tasks.

Each is named by the dotted path of its class and takes part in the same loop, with the same map,
information and motion, as the package's own strategies (`infomap_ros.views.ranking.strategies`).
"""
