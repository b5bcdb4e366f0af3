#pragma once

#include <stdexcept>
#include <string>

namespace shadelab {

/// Input that a user can mend. The message is one line: file, line where there is one, what is wrong, what to do.
/// Programs print it and exit with 2.
class InputError : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// Something of the machine or of ours failed (disk full, broken plugin). Programs print it and exit with 3.
class InfrastructureError : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

}  // namespace shadelab
