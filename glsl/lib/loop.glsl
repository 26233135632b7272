// lib/loop.glsl -- loops as each kind of device has them best.
// llvmpipe runs the body of a loop once more, for no lane, where the condition stands at its head: there it stands at the end.
// WHILE is for conditions that hold at first, or whose body does no harm. FOR_EACH is from first to before end, FOR_SOME the
// same where that is at least one.
#if USE_BRANCHLESS || defined(TEST_LAST)
const bool TESTS_LAST = true;
#define WHILE(condition) do
#define END_WHILE(condition) while (condition);
#define FOR_SOME(type, i, first, end) type i = first; do
#define FOR_EACH(type, i, first, end) type i = first; if (i < (end)) do
#define END_FOR(i, end) while (++i < (end));
#else
const bool TESTS_LAST = false;
#define WHILE(condition) while (condition)
#define END_WHILE(condition)
#define FOR_SOME(type, i, first, end) for (type i = first; i < (end); i++)
#define FOR_EACH(type, i, first, end) for (type i = first; i < (end); i++)
#define END_FOR(i, end)
#endif
