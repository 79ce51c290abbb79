/* A simulator with one thing wrong, which its first argument names. */
#include <stdlib.h>
#include <string.h>
#include <stillroom_actor.h>

static const char *wrong = "";
static int is(const char *name) { return strcmp(wrong, name) == 0; }

static stillroom_environment *make(void) { return is("make") ? NULL : malloc(1); }

static int see(void *const *numbers) {
    static float calls = 0.0f;
    *(float *)numbers[0] = is("random") ? calls++ : 0.5f;
    if (is("mask")) memset(numbers[1], 0, 2);
    return 0;
}

static int reset(stillroom_environment *e, uint32_t seed, void *const *numbers) {
    (void)e, (void)seed;
    return is("reset") ? 1 : see(numbers);
}

static int step(stillroom_environment *e, uint32_t action, void *const *numbers, stillroom_result *result) {
    (void)e, (void)action, (void)result;
    return is("step") ? 1 : see(numbers);
}

static const char *problem(void) { return is("step") ? "the robot fell over" : NULL; }

int main(int argc, char **argv) {
    uint32_t shape[] = {1}, actions[] = {2};
    stillroom_channel channels[] = {{"seen", STILLROOM_OBSERVATION, STILLROOM_F32, 1, shape, -1e9, 1e9},
                                    {"mask", STILLROOM_MASK, STILLROOM_U8, 1, actions, 0, 0}};
    stillroom_simulator simulator = {STILLROOM_ACTOR_ABI, 2, "wrong", channels, 1, make, reset, step, problem};
    wrong = argv[1];
    if (is("abi")) simulator.abi = 7;
    if (is("actions")) simulator.actions = 255;
    if (is("name")) simulator.name = NULL;
    if (is("channels")) simulator.channels = NULL;
    if (is("count")) simulator.channel_count = (size_t)-1;
    if (is("functions")) simulator.step = NULL;
    if (is("mask")) simulator.channel_count = 2;
    if (is("role")) channels[0].role = 9;
    if (is("dimensions")) channels[0].dimensions = 9;
    if (is("shape")) channels[0].shape = NULL;
    if (is("text")) channels[0].name = "\xff";
    if (is("outcome")) channels[0].role = STILLROOM_OUTCOME;
    int status = is("argv") ? stillroom_serve(&simulator, argc - 1, NULL)
                            : stillroom_serve(is("null") ? NULL : &simulator, argc - 1, argv + 1);
    return status && !*stillroom_error() ? 99 : status;
}
