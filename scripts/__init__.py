"""Command line: parse, call, print. One file a command."""
