"""A journal in databases on several machines, in virtual time: copies, delays, losses, deaths and promotions."""
