"""Files of many programs: tables, vectors and point clouds, and what files that came with data may not do."""
