#include "commands.h"
namespace terse {}
