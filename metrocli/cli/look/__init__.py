"""The commands that show a result as a picture or as a page."""
