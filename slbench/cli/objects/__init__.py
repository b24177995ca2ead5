"""``slbench objects``: artefacts with certified dimensions."""
