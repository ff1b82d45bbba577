"""Serial ports and Ethernet handles."""
