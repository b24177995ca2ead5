"""What a real camera and projector are: measured in captures of them, one file a quantity."""
