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
    while (uint32_t ms = robot_wait(millis() - begun)) delay(ms); // it may last too long
}
