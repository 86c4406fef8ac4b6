"""Dense matching on the CPU: the registry of backends, and semi-global matching with what surrounds it."""
