"""The state folder of a fleet: where it is, its backup, and how it is put back."""
