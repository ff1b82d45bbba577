"""Benchmarks of estimates of the clocks of controllers, beside estimators without a bound."""
