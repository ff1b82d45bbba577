"""What every simulated controller has: its face, its oscillator, its truth, its vector bench."""
