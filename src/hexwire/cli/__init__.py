"""The command line: argument handling and printing, one file per command group."""
