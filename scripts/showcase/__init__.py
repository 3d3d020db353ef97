"""Pieces of the gallery (scripts/gallery.py): its light, its pictures, who is near whom, and its page."""
