"""What is handed out: starters, releases, packages, new assignments."""
