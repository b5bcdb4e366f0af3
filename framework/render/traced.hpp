#pragma once
// What a plugin's functions compare, row by row: on which side of each comparison a row lies, and how far from the other.

#include <shadelab/error.hpp>
#include <shadelab/plugin_library.hpp>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <string>
#include <unordered_map>
#include <vector>

namespace shadelab {

class Traced {
public:
    explicit Traced(const PluginLibrary& library) : origin_(library.trace(compared)) {}

    /// Evaluates the rows one by one. Not for several threads.
    template <class Real>
    void evaluate(const plugin::Function<Real>& function, int64_t count, const Real* in, Real* out) {
        for (; count > 0; --count, in += function.columns_in, out += function.columns_out) {
            margins().clear();
            function.evaluate(1, in, out);
            rows_.push_back(margins());
        }
    }

    /// int64 S, S times int64: the sites' addresses in the plugin's file; for each row S times two float32: the least and the
    /// largest of left minus right, NaN where the row does not come there.
    void write(const std::string& file) const {
        std::vector<std::pair<int64_t, size_t>> order;
        for (const auto& [site, number] : sites())
            if (number < most_sites) order.push_back({int64_t(site - origin_), number});
        std::sort(order.begin(), order.end());
        std::ofstream out(file, std::ios::binary);
        const int64_t count = int64_t(order.size());
        out.write(reinterpret_cast<const char*>(&count), sizeof count);
        for (const auto& [site, number] : order) {
            out.write(reinterpret_cast<const char*>(&site), sizeof site);
        }
        const Margin none{std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::quiet_NaN()};
        for (const std::vector<Margin>& row : rows_)
            for (const auto& [site, number] : order) {
                const Margin margin = number < row.size() ? row[number] : none;
                out.write(reinterpret_cast<const char*>(&margin), sizeof margin);
            }
        out.close();
        if (!out) throw InfrastructureError(file + ": cannot be written");
    }

private:
    struct Margin {
        float least = std::numeric_limits<float>::quiet_NaN(), most = least;
    };
    static constexpr size_t most_sites = 512;
    const char* origin_;
    std::vector<std::vector<Margin>> rows_;

    static std::unordered_map<const char*, size_t>& sites() {
        static std::unordered_map<const char*, size_t> all;
        return all;
    }
    static std::vector<Margin>& margins() {  ///< of the row that is evaluated
        static std::vector<Margin> all;
        return all;
    }
    static void compared(const void* site, double left, double right) {
        const size_t number = sites().try_emplace(static_cast<const char*>(site), sites().size()).first->second;
        if (number >= most_sites) return;
        if (number >= margins().size()) margins().resize(number + 1);
        Margin& margin = margins()[number];
        const float difference = float(left - right);
        margin.least = std::fmin(margin.least, difference);  // of a number and NaN the number
        margin.most = std::fmax(margin.most, difference);
    }
};

}  // namespace shadelab
