"""Programs of other machines as jobs of the fleet: checked, drawn, and begun again where they stood."""
