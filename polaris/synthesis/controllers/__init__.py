"""Experimental controllers: laws, networks and black boxes, and their tubes."""
