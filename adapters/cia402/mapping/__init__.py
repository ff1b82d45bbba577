"""The PDO mapping of a drive: what is required, what the drive can map, and how it is mapped."""
