"""Physics: the planar model and the engines that roll it out."""
