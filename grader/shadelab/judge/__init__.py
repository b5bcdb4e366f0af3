"""Numbers against numbers: verdicts and diagnosis. Nothing here runs anything."""
