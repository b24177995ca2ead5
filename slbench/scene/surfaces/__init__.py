"""How surfaces scatter light: materials, their models, textures, and what is inside."""
