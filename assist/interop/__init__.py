"""Problems and policies in other programs' formats."""
