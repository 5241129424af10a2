"""The command line, `pdcd COMMAND ...`: results go to stdout, progress and errors to stderr.

Nothing but the parser is imported until a command runs.
"""
