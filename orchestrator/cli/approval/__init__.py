"""Plans of proposed jobs: shown and approved."""
