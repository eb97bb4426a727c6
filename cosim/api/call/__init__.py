"""What calls share: arguments that are checked, a hearer of progress, and a result that shows itself."""

from cosim.api.call.arguments import Limits, check_types
from cosim.api.call.result import FolderResult, Progress, Result, Table, WholeLine, note_lines
