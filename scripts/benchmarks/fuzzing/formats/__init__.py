"""One module a format: `SEEDS`, a function to sound files of many flavours, and `mutated`, which knows the format."""
