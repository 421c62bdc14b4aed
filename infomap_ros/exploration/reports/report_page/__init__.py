"""The page of a report: its parts as HTML and SVG, and the data of its 3-D viewer."""
