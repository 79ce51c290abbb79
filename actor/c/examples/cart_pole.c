/* CartPole in C: balance a pole on a cart, two actions.
 *
 *     cc -O2 cart_pole.c -o cart_pole $(python -m stillroom flags) -lm
 *     orchestrator up --env-command ./cart_pole --run runs/cart-pole
 */
#include <math.h>
#include <stdlib.h>
#include <stillroom_actor.h>

struct stillroom_environment {
    double x, v, angle, turning;
    int steps;
};

/* SplitMix64, as a number from -0.05 to 0.05. */
static double drawn(uint64_t *state) {
    uint64_t z = (*state += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0 * 0.1 - 0.05;
}

static stillroom_environment *make(void) { return calloc(1, sizeof(stillroom_environment)); }

static void show(const stillroom_environment *e, float *seen) {
    seen[0] = (float)e->x, seen[1] = (float)e->v, seen[2] = (float)e->angle, seen[3] = (float)e->turning;
}

static int reset(stillroom_environment *e, uint32_t seed, void *const *numbers) {
    uint64_t state = seed;
    e->x = drawn(&state), e->v = drawn(&state), e->angle = drawn(&state), e->turning = drawn(&state);
    e->steps = 0;
    show(e, numbers[0]);
    return 0;
}

static int step(stillroom_environment *e, uint32_t action, void *const *numbers, stillroom_result *result) {
    double force = action ? 10.0 : -10.0, sine = sin(e->angle), cosine = cos(e->angle);
    double push = (force + 0.05 * (e->turning * e->turning) * sine) / 1.1;
    double bend = (9.8 * sine - cosine * push) / (0.5 * (4.0 / 3.0 - 0.1 * (cosine * cosine) / 1.1));
    double pull = push - 0.05 * bend * cosine / 1.1;
    e->x += 0.02 * e->v, e->v += 0.02 * pull;
    e->angle += 0.02 * e->turning, e->turning += 0.02 * bend;
    show(e, numbers[0]);
    result->reward = 1.0;
    result->terminated = fabs(e->x) > 2.4 || fabs(e->angle) > 0.20943951;
    result->truncated = ++e->steps >= 500;
    return 0;
}

int main(int argc, char **argv) {
    static const uint32_t shape[] = {4};
    static const stillroom_channel seen = {"observation", STILLROOM_OBSERVATION, STILLROOM_F32, 1, shape, -1e9, 1e9};
    static const stillroom_simulator simulator = {STILLROOM_ACTOR_ABI, 2, "cart_pole", &seen, 1, make, reset, step, NULL};
    return stillroom_serve(&simulator, argc, argv);
}
