"""Bags of any format, whole or damaged, read and written."""
