/* Of Betaflight 4.6.0 what an adapter uses: declarations alone. */
