#include "robot.h"
${include}
${parts}
static uint32_t begun;

void setup()
{
${setup}    robot_open();
    begun = millis();
}

void loop()
{
${each}    robot_step();
    delay(robot_wait(millis() - begun));
}
