"""The steps of a controller: loaded, promised, released, followed to their ends, withdrawn."""
