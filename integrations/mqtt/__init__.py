"""States of a fleet on an MQTT broker, for dashboards and historians: `tutti mqtt serve`. It only publishes."""
