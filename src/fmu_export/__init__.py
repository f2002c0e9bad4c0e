"""From a unit (its interface table and its step code) to FMI 2.0 files."""
