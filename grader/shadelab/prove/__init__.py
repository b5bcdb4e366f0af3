"""Grades the grader: declared mistakes, correct variants, mutants."""
