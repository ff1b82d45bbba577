"""Parts that all simulated controllers share: interface, oscillator, ground truth and vector bench."""
