#ifndef ROBOT_H
#define ROBOT_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

${floats}
${types}

/* To be written by you. Return false if there is no reading, or it was not taken. */
${heads}

enum { /* the parts, and how many there are */
    ${parts}
};

typedef struct {
    uint32_t steps;   /* how many were made */
    uint32_t late;    /* how many were left out */
    uint32_t refused; /* commands that met a higher priority, a blind reaction or a guard */
    uint32_t faults;  /* of parts: no reading, not taken, an error of a reaction */
    uint8_t fault;    /* the part of the last one */
    bool armed;       /* whether actuators may move */
} robot_state;

extern robot_state robot;

void robot_open(void);            /* first: each actuator gets its safe command */
void robot_step(void);            /* read, decide, write */
uint32_t robot_wait(uint32_t ms); /* since robot_open; how many until the next step */
void robot_skip(uint32_t steps);  /* leave out steps that come too late */
void robot_arm(bool armed);       /* let actuators move from the next step on, or not */
bool robot_reset(uint8_t part);   /* let a guard that has latched decide again */
void robot_close(void);           /* last: the safe commands */

#ifdef __cplusplus
}
#endif
#endif
