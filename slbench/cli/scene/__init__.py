"""``slbench scene``: shipped scenes, and pictures of any scene."""
