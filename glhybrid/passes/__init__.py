"""One module per pass, none importing another. A pass owns no image: targets.py allocates what the plan lists."""
