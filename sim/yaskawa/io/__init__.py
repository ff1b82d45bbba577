"""Inputs and outputs: points on the terminals, devices on Ethernet, Modbus."""
