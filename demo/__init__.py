"""The sample capture, and the programs that draw it and train the scene which the package brings."""
