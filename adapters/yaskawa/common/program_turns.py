"""How often the resident program looks, and how many commands its turns take: what its timing is computed from."""

STEP_TICKS = 4  # between two checks of the release gate
FOLLOWING_STEP_TICKS = 2  # between two looks of a step that follows another one
LAST_LOOK_TICKS = 6  # before its start
BEGIN_TICKS = 3  # before its start: the jump and the wait still fit
FOLLOWING_COMMANDS = 10  # from the end of the present step to the wait of the following one, in its thread
SINGLE_CONDITIONS = 4  # further ones where conditions cannot be combined
SHORT_CHECK_AXES = 2  # of a controller: for more, the check of the positions takes a command of its own
STAMP_COMMANDS = 2  # for each axis of the present step, in that one's thread
RELEASED_COMMANDS = 6  # from a release at rest to the wait
SPARE_TICKS = 2  # for commands that take longer than usual
