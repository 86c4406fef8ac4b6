"""How the engine runs: processes and clusters, memory and disk, files that are whole or absent, progress, languages."""
