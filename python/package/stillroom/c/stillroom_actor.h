/* A simulator in any language takes part in a run of Stillroom.
 *
 * Fill in a stillroom_simulator and call stillroom_serve from main:
 *
 *     int main(int argc, char **argv) { return stillroom_serve(&simulator, argc, argv); }
 *
 * Link with -lstillroom_actor, and start a run: orchestrator up --env-command ./my_simulator. The orchestrator starts the
 * program for each actor and is killed with it; what the program prints goes to the actor's log. The example is
 * cart_pole.c; the book's page "Your own simulator" says what an environment must be.
 *
 * All calls come from the thread of stillroom_serve, one at a time.
 */
#ifndef STILLROOM_ACTOR_H
#define STILLROOM_ACTOR_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Of this header. A library of another one refuses the simulator. */
#define STILLROOM_ACTOR_ABI 1

/* The type of a channel's numbers. */
enum stillroom_dtype {
    STILLROOM_U8 = 0,
    STILLROOM_U16 = 1,
    STILLROOM_I32 = 2,
    STILLROOM_U32 = 3,
    STILLROOM_F32 = 4
};

/* What a channel is for. */
enum stillroom_role {
    STILLROOM_OBSERVATION = 0, /* what the policy is given */
    STILLROOM_PART = 1,        /* part of rewards or a cost, of the last action: one STILLROOM_F32 */
    STILLROOM_OUTCOME = 2,     /* what else the last action led to */
    STILLROOM_MASK = 3,        /* 1 for each action that may be taken now, 0 for others: STILLROOM_U8 [actions] */
    STILLROOM_PRIVILEGED = 4   /* numbers that the critic alone is given */
};

/* A named array of numbers that every step fills in. */
typedef struct stillroom_channel {
    const char *name;      /* lower-case letters, digits, underscores */
    uint32_t role;         /* enum stillroom_role */
    uint32_t dtype;        /* enum stillroom_dtype */
    uint32_t dimensions;   /* 0: one number; at most 8 */
    const uint32_t *shape; /* a size for each dimension; may be NULL without dimensions */
    double least, most;    /* all numbers lie between; a mask, and an image of STILLROOM_U8 or STILLROOM_U16, need none */
} stillroom_channel;

/* What an action led to. */
typedef struct stillroom_result {
    double reward;
    uint8_t terminated; /* the task has ended the episode */
    uint8_t truncated;  /* something else has, such as a limit of time */
} stillroom_result;

/* An environment of the simulator's: whatever `make` returns. */
typedef struct stillroom_environment stillroom_environment;

/* A simulator. All of it must stay as it is until stillroom_serve returns. */
typedef struct stillroom_simulator {
    uint32_t abi;                      /* STILLROOM_ACTOR_ABI */
    uint32_t actions;                  /* how many there are, 1 to 254 */
    const char *name;                  /* of the task: lower-case letters, digits, underscores */
    const stillroom_channel *channels; /* at least one observation */
    size_t channel_count;              /* at most 256 */

    /* Makes an environment; an actor has several. NULL: it cannot. */
    stillroom_environment *(*make)(void);

    /* Begins the episode of a seed, whatever happened before: the same seed and actions always lead to the same numbers.
     * `numbers[i]` is where channel i's numbers are written, in the order of the channels, row by row. Observations, a
     * mask and privileged numbers must be written, others need not. Returns 0, or anything else for a failure. */
    int (*reset)(stillroom_environment *environment, uint32_t seed, void *const *numbers);

    /* Takes an action, 0 to actions - 1, writes all channels as `reset` does, and the result. An episode that has ended is
     * followed by a reset. */
    int (*step)(stillroom_environment *environment, uint32_t action, void *const *numbers, stillroom_result *result);

    /* What is wrong after make, reset or step has failed, as a sentence; it may be NULL, and so may this pointer. */
    const char *(*problem)(void);
} stillroom_simulator;

/* Serves the simulator to the orchestrator that has started this program, and returns the exit status for main: 0 after a
 * question is answered, otherwise not 0. Why it failed is printed to standard error, and is the text of stillroom_error. */
int stillroom_serve(const stillroom_simulator *simulator, int argc, char *const *argv);

/* Why stillroom_serve has failed; an empty text before. It stays as it is until the next call of stillroom_serve. */
const char *stillroom_error(void);

#ifdef __cplusplus
}
#endif

#endif
