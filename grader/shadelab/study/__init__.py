"""Studies: error against run time, declared in studies/NAME.toml or built in for every scene."""
