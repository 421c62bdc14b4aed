"""How the map is stored, asked, and compared with its copies."""
