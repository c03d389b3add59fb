"""Services of the operating system and Python: files, processes, threads, limits, progress, compiled code.

Nothing in this folder is about planning.
"""
