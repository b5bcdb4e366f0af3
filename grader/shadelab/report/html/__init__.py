"""The result as one HTML page: its words, its pictures, what its viewers read, its plots."""
