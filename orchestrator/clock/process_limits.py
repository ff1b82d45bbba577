"""What the operating system allows a process. Windows knows none of these limits: there nothing is changed."""

import signal
import sys

if sys.platform == "win32":

    def allow_open_files(wanted: int) -> None:
        """Let this process have so many files and connections open, or as many as this user may have."""

    def limit_memory(max_bytes: int) -> None:
        """Let a request for memory fail, beyond so many bytes of address space."""

    def end_after(seconds: int) -> None:
        """Let this process end after a time, whatever it does then; 0: never."""
else:
    import resource

    def allow_open_files(wanted: int) -> None:
        """Let this process have so many files and connections open, or as many as this user may have."""
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(
            resource.RLIMIT_NOFILE, (wanted if most == resource.RLIM_INFINITY else min(most, wanted), most)
        )

    def limit_memory(max_bytes: int) -> None:
        """Let a request for memory fail, beyond so many bytes of address space."""
        resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))

    def end_after(seconds: int) -> None:
        """Let this process end after a time, whatever it does then; 0: never."""
        signal.alarm(seconds)
