"""Files of many programs: tables, vectors and point clouds, and the limits for untrusted files."""
