"""Project, composite, differentiate, label: one interface, three backends."""
