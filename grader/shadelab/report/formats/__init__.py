"""Reports that other programs read: each a function of the result alone."""
