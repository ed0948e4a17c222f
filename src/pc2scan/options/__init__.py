"""The one table of options: what each of them means, who takes it, and the options of one call.

``projection``, ``conversion``, ``running`` and ``commands`` declare them in groups, ``table`` says which command takes
which groups, ``values`` has the types of their values, ``call`` reads them from Python, the command line and files. To
add an option: a field of a group, and the code that obeys it.
"""
