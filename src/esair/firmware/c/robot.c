#include "robot.h"
${math}#include <setjmp.h>
#include <stddef.h>
#include <string.h>

enum { ${counts} };
#define ES_EVERY UINT32_C(${every})
#define ES_GAP UINT32_C(${gap})
#define ES_ODD UINT32_C(${odd})

${core}
/* The robot. */

${robot}
robot_state robot = {.armed = ${armed}};
