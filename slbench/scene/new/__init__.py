"""New scene files, from hardware files, data sheets and a ruler."""
