"""How a data set lies on disk: shards, index, manifest."""
