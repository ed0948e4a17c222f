"""The one table of options: what each of them means, who takes it, and the options of one call.

``table`` declares them, ``values`` has the types of their values, ``call`` reads them from Python, the command line and
files. Adding an option: a field in ``table``, and the code that obeys it.
"""
