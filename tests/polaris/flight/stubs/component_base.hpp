// Stub of what fpp-to-cpp makes of @NAME@.fpp: it keeps what the component says.
#ifndef BASE_HPP
#define BASE_HPP

#include <array>
#include <cstdint>

typedef int16_t FwIndexType;
typedef int32_t I32;
typedef uint32_t U32;
typedef float F32;
typedef double F64;

namespace Fw {
struct ParamValid {
    enum T { UNINIT, VALID, INVALID, DEFAULT };
    T e = UNINIT;
    bool operator==(T other) const { return this->e == other; }
    bool operator!=(T other) const { return this->e != other; }
};
}  // namespace Fw

namespace @MODULE@ {

typedef std::array<@REAL@, @N@> @NAME@State;
typedef std::array<@REAL@, @M@> @NAME@Force;

class @NAME@ComponentBase {
  public:
    explicit @NAME@ComponentBase(const char*) {}
    virtual ~@NAME@ComponentBase() = default;
    virtual void inputIn_handler(FwIndexType, I32, const @NAME@State&, I32, const @NAME@Force&) = 0;

    struct Said {
        bool allow = true, connected = true;
        Fw::ParamValid::T valid = Fw::ParamValid::DEFAULT;
        U32 every = 1U;
        int written = 0, faults = 0, modes = 0, verdicts = 0;
        I32 period = -1, mode = -1;
        U32 fault = 0U;
        @NAME@Force force{};
        @REAL@ margin = -1;
    } said;

  protected:
    bool paramGet_ALLOW_EXPERIMENTAL(Fw::ParamValid& valid) {
        valid.e = this->said.valid;
        return this->said.allow;
    }
    U32 paramGet_TELEMETRY_EVERY(Fw::ParamValid& valid) {
        valid.e = Fw::ParamValid::DEFAULT;
        return this->said.every;
    }
    bool isConnected_verdictOut_OutputPort(FwIndexType) const { return this->said.connected; }
    void verdictOut_out(FwIndexType, I32 p, I32 who, U32 what, const @NAME@Force& u, @REAL@ left) {
        this->said.period = p;
        this->said.mode = who;
        this->said.fault = what;
        this->said.force = u;
        this->said.margin = left;
        this->said.verdicts++;
    }
    void log_WARNING_HI_FaultRaised(U32, I32) { this->said.faults++; }
    void log_ACTIVITY_HI_ModeChanged(I32, I32) { this->said.modes++; }
    void tlmWrite_Period(I32) { this->said.written++; }
    void tlmWrite_Mode(I32) {}
    void tlmWrite_Fault(U32) {}
    void tlmWrite_Margin(@REAL@) {}
};

}  // namespace @MODULE@

#endif
