"""What a job passes before it waits: checks, uploads, its plan and the approval of that."""
