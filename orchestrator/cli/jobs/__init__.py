"""Jobs: submitted, checked, shown, put in order, approved."""
