"""Bare earth: the terrain without houses and trees, from a DSM (docs/method.md, "Bare earth")."""
