/* Where a Cortex-M begins: stack and first function; the floating-point unit is off until it is switched on. */
extern unsigned long top_of_stack;
extern void _start(void);

static void reset(void)
{
    *(volatile unsigned long *)0xE000ED88u |= 0xFul << 20; /* CPACR */
    __asm volatile("dsb\n isb");
    _start();
}

typedef union {
    unsigned long *stack;
    void (*run)(void);
} Vector;

__attribute__((section(".vectors"), used)) static const Vector vectors[2] = {{.stack = &top_of_stack}, {.run = reset}};
