"""What one asks of one's own code outside of a grading: a pixel, the ends of the domains, the machine."""
