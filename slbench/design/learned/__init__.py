"""Pattern sets learned on light: for a scene or a data set, by gradients (the extra ``torch``)."""
