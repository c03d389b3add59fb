"""What the machine gives: files, processes, threads, limits, progress and compiled code. Nothing of planning."""
