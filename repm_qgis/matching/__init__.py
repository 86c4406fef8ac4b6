"""Dense matching: the registry of backends, semi-global matching with all its steps, and the coarse surface."""
