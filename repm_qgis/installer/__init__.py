"""The engine's own Python environment: what it takes, where it lies, how it is made, renewed and removed.

Standard library alone: it runs where the packages that it installs are still missing, in QGIS's process too.
"""
