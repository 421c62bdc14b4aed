"""``python -m infomap_ros.cli``."""

from infomap_ros.cli import main

if __name__ == "__main__":
    main()
