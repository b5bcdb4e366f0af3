"""The command line: one file per group of commands. stdout carries the result, stderr progress and messages."""
