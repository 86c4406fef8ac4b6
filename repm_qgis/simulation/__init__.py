"""Truth scenes: known surfaces seen by simulated pushbroom satellites, for demonstrations, tests and benchmarks.

What -> file: the ground -> ``surface``, ``mountains``, ``town``; orbit, attitude and detectors -> ``sensor``; what a
date makes of the ground -> ``seasons``; pixels -> ``render``; the RPC that a vendor would deliver -> ``rpc/fit``; all of it as files on disk -> ``scene``.
"""
