"""A page that shows a run while it goes on: map, robot, views, reasons; with buttons where it can.

`LivePage` is told what there is to show, by a node or by a command, and serves it to browsers.
"""

from infomap_ros.viewer.live_page import LivePage, PageConfig

__all__ = ["LivePage", "PageConfig"]
