"""Camera and projector from boards in free poses: one adjustment over both."""
