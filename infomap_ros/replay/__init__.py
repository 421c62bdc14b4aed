"""Bags, and the same records that live topics become."""
