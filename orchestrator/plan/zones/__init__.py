"""Keep-out zones: whether a step keeps bodies apart that ride on its axes, proven and not sampled."""
