"""Truth scenes: known surfaces seen by simulated pushbroom satellites, for demonstrations, tests and benchmarks.

What -> file: the ground -> ``surface``; orbit, attitude and detector line -> ``sensor``; pixels -> ``render``; the RPC
that a vendor would deliver -> ``rpc_fit``; all of it as files on disk -> ``scene``.
"""
