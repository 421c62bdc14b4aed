"""ROS 2 nodes: convert a message, call one core object, convert its answer, publish.

Here stand the nodes themselves; their parts are in the folders beside them.

The only room that imports rclpy and message packages. Importing it sets how the process uses its
memory: rclpy starts threads when it is imported, and that must be done before. In the process of a
node it also sets what an interrupt does while the rest, some seconds' worth, is imported.
"""

from infomap_ros.nodes.common.interrupts import leave_at_once, runs_a_node

if runs_a_node():
    leave_at_once()

from infomap_ros.nodes.common.memory import keep_freed_memory

keep_freed_memory()
