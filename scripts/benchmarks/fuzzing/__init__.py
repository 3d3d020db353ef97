"""What `fuzz_readers.py` is made of: mutated files of every format, and processes that read them under watch."""
