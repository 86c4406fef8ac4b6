"""COLMAP on a CUDA GPU: frame, workspace, process, and heights from depth maps."""
