"""From a finished surface model to point clouds and meshes."""
