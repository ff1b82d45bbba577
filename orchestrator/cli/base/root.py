"""The end of a root command: its exit code, and the message of its error."""

import sys
from collections.abc import Sequence
from typing import Any

import click


class RootGroup(click.Group):
    """The commands of a program, and its exit."""

    def main(self, args: Sequence[str] | None = None, *rest: Any, **options: Any) -> Any:
        """Run the command and exit by the rule for exit codes; every error has its message."""
        words = list(sys.argv[1:] if args is None else args)
        from orchestrator.cli.base import errors, output
        from orchestrator.cli.base.encoding import replace_unknown_signs

        replace_unknown_signs()
        errors.note_arguments(words)
        try:
            code = super().main(words, *rest, **{**options, "standalone_mode": False})
            sys.stdout.flush()  # a full disk is found here, and not while the interpreter ends
            sys.exit(code)
        except click.exceptions.NoArgsIsHelpError as error:
            error.show()
            sys.exit(error.exit_code)
        except click.ClickException as error:
            errors.exit_with_usage_error(error)
        except (click.Abort, KeyboardInterrupt):
            errors.exit_interrupted()
        except Exception as error:
            if isinstance(error, OSError) and output.is_output_error(error):
                output.exit_output_failed(error)
            errors.exit_with_any_error(error)
