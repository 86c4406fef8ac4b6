"""What is used together must fit together: the one gate for rasters, their companions and their times.

Each check either refuses, with the file, the value and what to do, or gives findings, which take the "Good." from the
run's verdict. Algorithms pass their inputs through it, and judge none of this themselves.
"""
