"""The live state of the fleet: collected from the bus, sent to pages and programs as numbered differences."""
