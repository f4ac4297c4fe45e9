// Hands calls from the standard input to the component, and writes its verdicts. Arguments: allow, validity of that, connected, every.
#include "@NAME@.hpp"

#include <cstdio>
#include <cstdlib>

int main(int, char** given) {
    @MODULE@::@NAME@ component("flown");
    @MODULE@::@NAME@ComponentBase& base = component;
    base.said.allow = std::atoi(given[1]) != 0;
    base.said.valid = static_cast<Fw::ParamValid::T>(std::atoi(given[2]));
    base.said.connected = std::atoi(given[3]) != 0;
    base.said.every = static_cast<U32>(std::atoi(given[4]));
    int period = 0;
    int who = 0;
    while (std::scanf("%d %d", &period, &who) == 2) {
        @MODULE@::@NAME@State x;
        @MODULE@::@NAME@Force u;
        double value = 0;
        for (auto& one : x) {
            if (std::scanf("%la", &value) != 1) return 1;
            one = static_cast<@REAL@>(value);
        }
        for (auto& one : u) {
            if (std::scanf("%la", &value) != 1) return 1;
            one = static_cast<@REAL@>(value);
        }
        base.inputIn_handler(0, period, x, who, u);
        std::printf("%d %d %u", base.said.period, base.said.mode, base.said.fault);
        for (auto one : base.said.force) std::printf(" %a", static_cast<double>(one));
        std::printf(" %a\n", static_cast<double>(base.said.margin));
    }
    std::printf("%d %d %d %d\n", base.said.verdicts, base.said.written, base.said.faults, base.said.modes);
    return 0;
}
