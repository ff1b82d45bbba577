"""What both Yaskawa models share."""
