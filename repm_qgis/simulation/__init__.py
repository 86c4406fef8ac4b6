"""Truth scenes: known surfaces seen by simulated pushbroom satellites, for demonstrations, tests and benchmarks.

What -> file: the ground -> ``surface``, ``mountains``, ``town``; what a date makes of it -> ``seasons``; orbit,
attitude and detectors -> ``sensor``; pixels -> ``render``; the RPC that a vendor would deliver -> ``rpc/fit``; all of
it as files on disk -> ``scene``.
"""
