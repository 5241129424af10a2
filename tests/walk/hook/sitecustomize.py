"""Python imports this first where the folder is on PYTHONPATH: so processes are traced that the
program itself starts."""

from tests.walk.trace import begin

begin()
