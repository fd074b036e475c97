"""python -m rfpp.evaluation.report: see `rfpp.evaluation.report.evaluation_report`."""

from rfpp.evaluation.report.evaluation_report import main

if __name__ == "__main__":
    main()
