"""Alarms: what raises them, their register, and the notices of them."""
