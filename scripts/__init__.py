"""Command line: parse, call, print. One file a command; `scripts.__main__` is ``vessel-gym``, which knows them all.

They may import everything, late; nothing imports them.
"""
