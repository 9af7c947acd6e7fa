/* For tests: each line of the input is `s`, a step, then for each sensor 1 and its numbers or
   0 if it fails, and for each actuator whether it takes commands; `k N`, skip; `a 0`, `a 1`,
   arm; `r PART`, reset a guard; `c`, close; `o`, open. */
#include <stdio.h>
#include "robot/robot.h"

static int got;
static inline int32_t whole(void) { long x = 0; got += scanf("%ld", &x); return (int32_t)x; }
${number}

${parts}
static void hear(void)
{
${read}
}

int main(void)
{
    char what;
    robot_open();
    while (scanf(" %c", &what) == 1) {
        if (what == 's') {
            hear();
            robot_step();
            printf("= %lu %lu %lu\n", (unsigned long)robot.steps, (unsigned long)robot.faults,
                   (unsigned long)robot.refused);
        } else if (what == 'k') robot_skip((uint32_t)whole());
        else if (what == 'a') robot_arm(whole() != 0);
        else if (what == 'r') printf("reset %d\n", robot_reset((uint8_t)whole()));
        else if (what == 'c') robot_close();
        else if (what == 'o') robot_open();
    }
    robot_close();
    return got < 0;
}
