"""python -m rfpp.evaluation.tables: see `rfpp.evaluation.tables.of_the_paper`."""

from rfpp.evaluation.tables.of_the_paper import main

if __name__ == "__main__":
    main()
