"""Parts as they come from a workshop: brick, propeller, engine block, coins."""
