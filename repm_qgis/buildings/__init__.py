"""Buildings of a DSM: footprints, their heights with errors, and simple roofs (docs/algorithms/buildings.md)."""
