"""What a workspace holds, as plain data for people who look at it: images, runs, products.

Scenes, reports and files are read as they lie there, and nothing is kept elsewhere. A workspace may come from anybody:
what does not fit is left out, paths that lead out of it or to the network are shown as they are and never opened, and
nothing outside is ever removed.
"""
