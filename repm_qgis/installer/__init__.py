"""The engine's own Python environment: its requirements, its place, and how it is made, renewed and removed. Standard
library only: it runs where the packages that it installs are still missing, in QGIS's process too.
"""
